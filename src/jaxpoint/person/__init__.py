"""Follows people through a session: heads and arms over all views."""

"""From arms over time to answers: gestures, their lines, and what they point at."""

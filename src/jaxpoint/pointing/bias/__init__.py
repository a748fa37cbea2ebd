"""How far people's lines of pointing miss what they mean, learnt from known targets and taken back (SPEC 8)."""

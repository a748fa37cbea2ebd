"""One file a command: its flags as a dataclass, and what it does as `run`. Nothing heavy is imported before `run`."""

"""What every command has: its line of flags, its process, its messages, and its help in a shell."""

"""Settings: every one with its unit and default; and one way to JSON and back."""

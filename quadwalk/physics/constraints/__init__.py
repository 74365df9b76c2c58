"""What the floor and the joints' limits push back with: contacts, ground, solver."""

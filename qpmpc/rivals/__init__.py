"""Other ways to control the contact force, as controllers behind the same protocol."""

"""The commands: each parses, calls and prints; nothing is computed here."""

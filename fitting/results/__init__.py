"""The result of a material as JSON: its schema, reading and writing it."""

"""What comes out: tables, pictures, MERL files."""

"""DATA: MERL binary files, their grid and their masks; numpy only, knows no model."""

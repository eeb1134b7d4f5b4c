"""A folder of results for people: one table, and pages with pictures."""

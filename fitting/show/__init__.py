"""What people look at: pictures (each a function that returns a figure), tables of the terminal, pages."""

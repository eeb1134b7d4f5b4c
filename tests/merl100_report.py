def write(rows, folder):
    pass

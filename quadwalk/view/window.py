"""A live robot in MuJoCo's own window."""
def no_window():
    return "x"

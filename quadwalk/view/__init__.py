"""Drive a trained policy live: in a page of the browser, or in MuJoCo's own window."""

"""The page in which a robot runs: MuJoCo and its policy in the browser, written or served."""

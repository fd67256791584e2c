"""Documents as their readers use them: every command and Python block that they show is run."""

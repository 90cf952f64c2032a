"""What each command of `dream survey` does."""

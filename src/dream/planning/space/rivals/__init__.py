"""Published ways to choose where to look from in three dimensions, each re-implemented for comparison."""

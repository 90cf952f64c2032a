"""A network that sees: labels and depth from colours, learned from pictures that DREAM draws itself."""

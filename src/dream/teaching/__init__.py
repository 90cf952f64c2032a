"""Pictures, and a few marks on them → a network that labels a target."""

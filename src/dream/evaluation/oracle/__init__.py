"""What a mission could have achieved by one who knows the world: certified bounds and the best tours."""

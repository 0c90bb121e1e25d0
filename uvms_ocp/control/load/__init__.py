"""What the tool carries, learnt from what the disturbance observer finds."""

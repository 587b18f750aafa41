"""Other programs' files: motion for animation tools, head poses from elsewhere."""

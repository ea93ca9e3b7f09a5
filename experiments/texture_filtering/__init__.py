"""What each texture filter costs, and what it gets wrong."""

"""What multisampling keeps of supersampling, and how it goes wrong."""

"""Compare multisampling with supersampling, and show its typical mistakes."""

"""Compare the time and error of exact supersampling with those of other renderers."""

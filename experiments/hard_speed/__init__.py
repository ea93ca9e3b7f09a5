"""How fast is exact supersampling, and what does its error cost elsewhere?"""

"""What does each effect of a scene cost?"""

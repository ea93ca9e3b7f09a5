"""This stage computes where elements lie: paths, transforms, viewports, bounds, clip paths."""

"""The ground where it is not flat: a height map, and how to look it up.

- `height_map`: heights on a grid; height, normal and distance of points from the ground

It imports nothing of dynappo; `physics` imports it.
"""

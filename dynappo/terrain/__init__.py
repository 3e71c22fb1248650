"""The ground, where it is not the flat floor at height 0.

- `height_map`: heights on a grid, and how high and how steep it is at a point
- `tiles`: makes a rough ground from a seed and the config: stairs, boxes, slopes, from easy to hard
- `map_file`: a ground from an array or a picture in a file
- `curriculum`: which tile a robot gets next
- `scan`: where a robot is in the world, and what it sees of the ground

`config`, `physics`, tasks, `policy`, `program`, `look`, `evaluate`, `export`, `page` and `web` import it; it
imports no other folder. All but `curriculum` need no JAX.
"""

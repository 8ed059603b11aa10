"""A result as files that other programs open: a page, a raster, points."""

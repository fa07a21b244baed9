"""Arithmetic only: geometry, ordering, motion. Values in, values out; no files, ports, clocks, SVG or boards."""

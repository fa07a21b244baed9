"""The order in which strokes are drawn, their directions, and which of them are one."""

"""Strokes and limits in, a Plan out: what the pen will do, as piecewise cubics in time, independent of any board."""

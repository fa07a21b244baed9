"""One module per drawing; each has a function that returns the whole SVG file as text, the same text on every run."""

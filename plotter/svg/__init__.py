"""SVG document to Drawing: layers, strokes, colours, in page millimetres."""

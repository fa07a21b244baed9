"""A plan to a board: commands, exact firmware arithmetic, encoding, streaming, virtual boards, verification."""

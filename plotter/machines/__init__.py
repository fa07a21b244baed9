"""Machine and pen-lift profiles as data (TOML), one schema."""

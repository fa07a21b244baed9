"""The program a person meets: command line, settings, machine profiles, reading drawings, previews."""

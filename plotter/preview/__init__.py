"""Pictures of a plan: pen-down and pen-up paths."""

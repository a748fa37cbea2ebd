"""The shapes of objects: one file each, all of one interface (`AbstractShape`), known by name through the registry."""

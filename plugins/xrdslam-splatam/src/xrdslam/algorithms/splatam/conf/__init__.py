"""Published settings per dataset family, and presets."""

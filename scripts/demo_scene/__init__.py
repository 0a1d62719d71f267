"""The demo scene: its true geometry, its renders and its sparse model."""

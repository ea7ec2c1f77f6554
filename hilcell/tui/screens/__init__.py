"""One file a screen; each shows the scene and posts commands."""

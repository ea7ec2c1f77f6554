"""One file a screen; each shows the view and posts commands."""

"""The application: keys become actions on the run that is shown."""

"""Programs of Universal Robots: poses read, corrected, written."""

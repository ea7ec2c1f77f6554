"""Fits of foreign robots: files, methods, arms, targets."""

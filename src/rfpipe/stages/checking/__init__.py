"""Checks of everything that lies in a run's folder, and the commands that mend what is damaged."""

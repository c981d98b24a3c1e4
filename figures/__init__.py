"""The thesis' figures and tables, a script each: ``make figures``."""

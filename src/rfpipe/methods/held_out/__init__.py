"""Pictures that no fit sees, and what they say of the error of a transport."""

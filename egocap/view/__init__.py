"""Pictures for people: what the method sees and makes of it."""

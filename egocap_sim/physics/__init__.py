"""Forward dynamics of the person: model, control, simulation. Import the modules directly."""

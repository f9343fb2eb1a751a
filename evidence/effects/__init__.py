"""Study of wheels, thrusters, modes and contact: consistency, and error over the bound."""

"""Study of a servicer's effects from samples: consistency, and error over the bound."""

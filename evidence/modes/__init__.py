"""Study of panels and liquid: sigma over the bound that has them among its unknowns."""

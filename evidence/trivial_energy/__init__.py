"""Study: why the energy method as printed has a trivial solution."""

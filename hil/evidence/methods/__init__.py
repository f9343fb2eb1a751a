"""Study of the identification methods: error over Cramer-Rao bound, seed by seed."""

"""Study of the identification methods: their errors over the Cramer-Rao bound, for many seeds."""

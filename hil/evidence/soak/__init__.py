"""Days in virtual time under random faults: what must stay bounded, exact and honest."""

"""Days in virtual time under random faults: memory is bounded, slips exact, estimates honest."""

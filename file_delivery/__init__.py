"""Both ends of file delivery (CCSDS 727.0-B, class 2), used on board and on the ground."""

"""What a robot would touch in other postures, without touching the world."""

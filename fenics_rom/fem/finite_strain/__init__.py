"""Large deformation at full order: hyperelastic forces, what they are solved with, and the steps."""

"""What a robot is to this project, and the one door to Brax."""

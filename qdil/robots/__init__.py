"""Robots: what a robot is to this project, which there are, and the only modules that use Brax."""

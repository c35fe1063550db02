"""Robots: the ``Environment`` type, the register of robots, and the only modules that use Brax."""

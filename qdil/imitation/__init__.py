"""Learned rewards: demonstrations, reward models, the measure bonus."""

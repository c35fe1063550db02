"""What stands in for the reward: demonstrations, reward models, the measure bonus."""

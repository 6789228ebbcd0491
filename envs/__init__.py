"""The Gymnasium side: the environments, their observations, rewards and pictures."""

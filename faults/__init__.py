"""The hostile campaign: what this package promises, tried against references and damage of every kind."""

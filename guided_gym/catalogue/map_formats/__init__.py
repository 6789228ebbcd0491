"""The formats of maps: what each says, without the options by which it becomes an environment."""

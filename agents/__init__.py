"""Policies for the environments: scripted ones, and what they have in common with learned ones."""

"""Brax's trainer on this project's environments, beside which ours is measured."""

"""Agents that learn the task: recipes, algorithms, demonstrations, policies."""

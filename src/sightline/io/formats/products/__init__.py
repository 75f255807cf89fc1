"""Products as their makers deliver them: metadata of a scene → its line-scan model, and what else it says."""

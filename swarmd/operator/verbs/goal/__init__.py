"""The verbs of goals: goal, resume and undo."""

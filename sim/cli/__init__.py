"""The verbs that need the laboratory: swarmctl sim and swarmctl demo."""

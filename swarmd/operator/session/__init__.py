"""The operator's side: who is there, requests, questions, and their outcome."""

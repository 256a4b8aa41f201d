"""Mutants of the code that decides motion: does a test fail for each of them?"""

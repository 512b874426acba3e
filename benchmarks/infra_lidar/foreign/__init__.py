"""Labelled clusters by three hands that share nothing with the training: they judge the forest and never teach it."""

"""Kills and stops the processes of a running service at random, and checks that no accepted job suffers from it."""

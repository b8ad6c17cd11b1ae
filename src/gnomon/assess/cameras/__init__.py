"""Verdict, tables and findings of cameras, alone and with IMUs."""

"""Logs as bytes: containers (MCAP, .db3, .bag), the types of their messages, and columns of chosen fields."""

"""Other people's methods that stand beside ours."""

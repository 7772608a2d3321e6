"""What tuning the controllers needs: what is to be small, and a search with a budget."""

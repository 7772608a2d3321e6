"""What tuning the controllers needs: a plant that is cheap, what is to be small, a search."""

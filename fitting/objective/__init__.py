"""What is minimised: weights, data in blocks, free coordinates, cost and normal equations."""

"""What every fit needs: tabulated targets, and one training loop."""

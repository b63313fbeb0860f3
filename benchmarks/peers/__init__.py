"""What others would use, written as they would write it; PyTorch is needed for all but the environments."""

"""Algorithm 2, MAML fine-tuning, and the controls between them."""

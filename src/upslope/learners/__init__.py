"""What learns one task: DQN, DDPG, and what they are made of."""

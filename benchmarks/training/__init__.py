"""Pre-training, fine-tuning and the speed of the trainer."""

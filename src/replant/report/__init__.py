"""What people read of a result: findings, numbers as text, figures, the HTML report, the terminal."""

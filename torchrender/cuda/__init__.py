"""What is known of cards.

``python -m torchrender.cuda check`` finds out whether torchrender works on this one, ``compile`` makes kernels for
others ahead of time.
"""

"""Tapes of derivatives: Jacobian, adjoint, and the Jacobian of the adjoint, which holds the Hessian."""

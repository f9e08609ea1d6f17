import numpy as np, torch, functools
from .scene import cie
@functools.lru_cache
def _t():
    g=np.arange(360,831.); k=np.arange(360,831,5.)
    m=np.stack([np.interp(g,k,cie._table(t)) for t in (cie._X,cie._Y,cie._Z)],1)
    w=np.ones(471);w[[0,-1]]=.5
    m=m*w[:,None]; m/=m.sum(0)
    d=np.interp(g,k,cie._table(cie._D65)); d/= (m[:,1]*d).sum()
    return torch.from_numpy(m@cie.XYZ_TO_RGB.T), torch.from_numpy(d)
def responses(dtype=torch.float64): return _t()[0].to(dtype).clone()
def d65(like): return _t()[1].to(like.dtype)
def to_rgb(t, illuminant=None):
    r=responses(t.dtype)
    return t@r if illuminant is None else (t*illuminant)@r
def sigmoid(c):
    x=torch.linspace(0,1,471,dtype=c.dtype)
    q=(c[...,0:1]*x+c[...,1:2])*x+c[...,2:3]
    return .5+q/(2*torch.sqrt(1+q*q))
class _C(torch.autograd.Function):
    @staticmethod
    def forward(rgb):
        r=rgb.detach().double().clamp(1e-4,1-1e-4); c=torch.zeros_like(r)
        M=(responses()*d65(r)[:,None])
        x=torch.linspace(0,1,471,dtype=torch.float64); P=torch.stack([x*x,x,torch.ones_like(x)])
        for s in range(1,41):
            tgt=.5+(r-.5)*min(1,s/20)
            for _ in range(2):
                q=c@P; inv=1/torch.sqrt(1+q*q); v=.5+.5*q*inv; dv=.5*inv**3
                res=v@M-tgt
                J=torch.einsum('...l,kl,lj->...jk',dv,P,M)
                c=c-torch.linalg.solve(J+1e-9*torch.eye(3,dtype=torch.float64),res)
        return c.to(rgb.dtype)
    @staticmethod
    def setup_context(ctx,i,o): ctx.save_for_backward(o); ctx.save_for_forward(o)
    @staticmethod
    def backward(ctx,g):
        c,=ctx.saved_tensors; c=c.double()
        M=(responses()*d65(c)[:,None]); x=torch.linspace(0,1,471,dtype=torch.float64); P=torch.stack([x*x,x,torch.ones_like(x)])
        q=c@P; inv=1/torch.sqrt(1+q*q); dv=.5*inv**3
        J=torch.einsum('...l,kl,lj->...jk',dv,P,M)
        return torch.linalg.solve(J.mT,g.double()).to(g.dtype)
def _jvp(ctx,t):
        c,=ctx.saved_tensors; c=c.double()
        M=(responses()*d65(c)[:,None]); x=torch.linspace(0,1,471,dtype=torch.float64); P=torch.stack([x*x,x,torch.ones_like(x)])
        q=c@P; inv=1/torch.sqrt(1+q*q); dv=.5*inv**3
        J=torch.einsum('...l,kl,lj->...jk',dv,P,M)
        return torch.linalg.solve(J,t.double()).to(t.dtype)
_C.jvp=staticmethod(_jvp)
def upsample(rgb, exact=True, light=False):
    m=rgb.amax(-1,keepdim=True)
    f=2*m if light else m.clamp(min=1)
    return torch.cat([_C.apply((rgb/f.clamp(min=1e-12)).clamp(0,1)), f],-1)
def irregular(w,v):
    return torch.from_numpy(np.interp(np.arange(360,831.),w.detach().double().numpy(),v.detach().double().numpy(),left=0,right=0))
def sellmeier(b,c):
    l=(torch.arange(360,831.,dtype=torch.float64)/1000)**2
    return torch.sqrt(1+(b[:,None]*l/(l-c[:,None])).sum(0))
def cauchy(a,b):
    l=(torch.arange(360,831.,dtype=torch.float64)/1000)**2
    return a+b/l
